"""Puts ``scripts/``, where both packages lie, on the import path: import it before them."""

import sys
from pathlib import Path

LIBRARY = str(Path(__file__).resolve().parents[1])
if LIBRARY not in sys.path:
    sys.path.insert(0, LIBRARY)
