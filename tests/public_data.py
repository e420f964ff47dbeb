"""Public recordings for tests; without them a test is skipped and says what is missing."""

from pathlib import Path

import pytest

from ambler.core.errors import BadInputError
from ambler.recordings.public_data import public_data


def public(name: str) -> Path:
    """Return a file or folder under AMBLER_DATA, or skip the test that asks for it."""
    try:
        return public_data(name)
    except BadInputError as error:
        pytest.skip(str(error))
