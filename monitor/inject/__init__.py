"""Faults injected into an ECU's frames (sensor faults and frame faults), and expected codes."""
