"""Tests of the measured signal that need no model: missing, implausible, not ready, frozen."""
