"""The description of the diagnostic server as ODX 2.2 (ISO 22901-1), made from its own tables."""
