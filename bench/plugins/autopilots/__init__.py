"""Logs of PX4 and ArduPilot, their own estimate, and a log for the replay of PX4."""

LOGS = {
    "ulog": {"endings": (".ulg",), "topics": True, "knows": True, "package": "pyulog"},
    "dataflash": {"endings": (".bin", ".px4log"), "topics": True, "knows": True},
}
"""Name of a format -> its row in `bench.io.log_formats`."""
