"""What every test shares: the photographs, if they are here, and the hypothesis profile."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("default", deadline=None, suppress_health_check=[HealthCheck.too_slow])
# CI draws the same examples each time: what fails there fails on every machine, and nothing fails by chance.
settings.register_profile("ci", settings.get_profile("default"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real photographs with references, or a skip with the reason."""
    here = Path(os.environ.get("STEREOCAL_DATA") or Path(__file__).parents[2] / "shared" / "data")
    if not here.is_dir():
        pytest.skip(f"no photographs at {here}: set STEREOCAL_DATA to the folder that holds them")
    return here
