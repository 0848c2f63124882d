"""Parts of bench that the core reaches by entry points alone."""
