import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def command():
    """The command fnopt of the same checkout, if it is built."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    found = os.environ.get("FNOPT_COMMAND") or shutil.which("fnopt", path=str(target / "release"))
    if not found:
        pytest.skip("cargo build --release has not been run")
    return found
