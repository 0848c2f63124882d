"""Everything that is read or written: configuration, results, logs, exports and filters of others."""
