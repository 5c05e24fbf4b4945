"""What several tests share: the rig, its ports, a broker, and paths."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SHARED = ROOT.parent / "shared"

# How long a test waits for what takes no time on an idle machine. A slow or busy machine may take a minute for a
# second's work. Only a program that hangs reaches this, and before the test's own limit, whose message says less.
PATIENCE_S = 600.0
