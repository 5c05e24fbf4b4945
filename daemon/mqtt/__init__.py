"""Telemetry and command over an MQTT broker; without a broker the service tracks on."""
