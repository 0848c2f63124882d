"""Packages of others are installed by a test, not collected."""

collect_ignore = ["examples"]
