"""Where photos and damaged files lie that are too large for the repository."""

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
FOLDER = Path(os.environ.get("AIRLIGHT_DATA", REPOSITORY.parent / "shared" / "data"))
"""`AIRLIGHT_DATA`, else `../shared/data` beside the repository; it need not be there."""
