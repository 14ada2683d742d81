"""Sinks: events and a thinned signal stream to MQTT, InfluxDB, Prometheus and plug-ins."""
