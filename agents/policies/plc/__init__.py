"""A feedback law of ten constants for a PLC, and the searches for its constants."""
