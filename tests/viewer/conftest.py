"""Fixtures of the viewer's tests."""

import pytest
import tiny_sequence
from viewer_session import Session


@pytest.fixture
def session(request, tmp_path):
    """The model with a sequence in the folder "first", of `FRAMES` of the test's module."""
    session = Session(tiny_sequence.write(tmp_path / "first", frames=getattr(request.module, "FRAMES", 3)))
    yield session
    session.model.close()
