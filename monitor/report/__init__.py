"""Replay and check of logs; text, JSON and HTML."""
