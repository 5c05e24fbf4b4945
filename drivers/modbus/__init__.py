"""Modbus: requests and replies, their frames on serial lines and TCP, and the client that asks over either."""
