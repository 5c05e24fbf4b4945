"""The trackers as a SunSpec device on Modbus TCP, for a control room."""
