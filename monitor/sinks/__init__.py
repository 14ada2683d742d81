"""Sinks: events and a thinned signal stream as lines of JSON, to MQTT and to plug-ins."""
