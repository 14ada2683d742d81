"""Recordings in and out, prepared signals, metrics."""
