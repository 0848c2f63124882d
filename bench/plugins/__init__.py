"""Parts of bench that the core uses only through entry points."""
