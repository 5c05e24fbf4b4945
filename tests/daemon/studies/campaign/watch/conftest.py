import pytest

from daemon.studies.campaign.watch.truth import TruthWatch
from tests.daemon.studies.campaign.watch.scripted import Scripted


@pytest.fixture
def plant():
    return Scripted(TruthWatch())
