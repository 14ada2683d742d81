"""Effects between the exhaust valve and the reading."""
