"""Random motions that resemble no shipped profile: truths of a filter, without flying an aircraft."""
