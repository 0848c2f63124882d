"""A run as a stream of messages, sent to a socket."""
