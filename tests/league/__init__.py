"""The league: filters from the package index, each behind an adapter, on one suite of flights."""
