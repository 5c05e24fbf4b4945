"""The UDP bridge that carries scans from a cube to its trackers. The format is described in docs/bridge.md."""
