"""Faults injected into an ECU's frames, sensor faults in tables, and expected codes."""
