"""What several tests share: the rig, its ports, a broker, and where things lie."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SHARED = ROOT.parent / "shared"

# How long a test waits for what comes at once on an idle machine. A slow or busy one takes a minute for a second's
# work; only a program that hangs reaches this, and before the limit of the test itself, which tells less.
PATIENCE_S = 600.0
