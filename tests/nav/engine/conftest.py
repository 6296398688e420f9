"""The drive through a city that several modules look at."""

import pytest

from oracles import rigs


@pytest.fixture(scope="session")
def city(tmp_path_factory) -> rigs.CityDrive:
    """A drive between houses, made once; see `rigs.city_drive`."""
    return rigs.city_drive(tmp_path_factory.mktemp("city"))
