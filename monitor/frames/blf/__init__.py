"""Vector's BLF files: their structure, and the reader in blocks."""
