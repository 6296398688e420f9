"""Study, tuning and comparison on a cluster of processes: the numbers of this machine's own."""

import json
import os
import threading
from pathlib import Path

import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.compare.comparison import compare
from certnav.nav.compare.methods import parse_methods
from certnav.nav.compare.runs import as_dict as compared
from certnav.nav.config import Config
from certnav.nav.results.summary import strict
from certnav.nav.spells.outages import parse_outages
from certnav.nav.study.recording import study
from certnav.nav.study.report import as_dict as studied
from certnav.nav.tune.candidates import candidates
from certnav.nav.tune.settings import tune_settings
from certnav.nav.tune.settings_report import as_dict as tuned
from oracles import sweeps

SPELLS = parse_outages("12/25:2-3")
METHODS = "gnss-only,alignment-only,lc4,lc+rows,lc+rows+smooth"
#: One of each kind: the default, thresholds, weights.
TRIED = ("default", "C/N0 > 40 dB-Hz", "weights fitted to undisturbed signals")
pytestmark = pytest.mark.filterwarnings("ignore")  # Dask's own


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Two drives of a minute, one without a reference: its judge has to travel."""
    home = tmp_path_factory.mktemp("drives")
    out = []
    for seed, density in ((31, "open"), (32, "suburb")):
        config = SimulationConfig(
            f"drive-{seed}", seed, 60.0, density=density, static_start=10.0, imu_rate=50.0
        )
        out.append(simulate_folder(config, home / config.name))
    (out[1] / "Groundtruth" / "groundtruth.txt").unlink()
    return out


class Killing(threading.Thread):
    """Kills the first worker that has something to do, whatever else the machine is busy with."""

    def __init__(self, address, workers):
        super().__init__(daemon=True)
        self.address, self.workers, self.killed = address, workers, False
        self._over = threading.Event()

    def __enter__(self):
        from distributed import Client

        self._client = Client(self.address, set_as_default=False)
        self._client.wait_for_workers(len(self.workers), timeout=60)
        self._pids = self._client.run(os.getpid)  # asked now: a busy one takes its time
        self.start()
        return self

    def run(self):
        while not self.killed and not self._over.wait(0.02):
            busy = [worker for worker, tasks in self._client.processing().items() if tasks]
            for worker in self.workers:
                if busy and worker.pid == self._pids[busy[0]]:
                    worker.kill()
                    worker.wait()
                    self.killed = True

    def __exit__(self, *_):
        self._over.set()
        self.join()
        self._client.close()


def _study(drives, **where):
    return studied(study(drives[:1] * 5, **where))


def _tune(drives, **where):
    found = tune_settings(drives, snr=[35.0], k=[0.2], outages=SPELLS, **where)
    return tuned(found)


def _compare(drives, **where):
    return compared(compare(drives, parse_methods(METHODS), SPELLS, Config(), **where))


@pytest.mark.parametrize("job", [_study, _compare, _tune])
def test_the_same_numbers_with_a_worker_killed_in_the_middle(job, drives, tmp_path, monkeypatch):
    few = [c for c in candidates(Config(), [35.0], [0.2]) if c.name in TRIED]
    assert len(few) == len(TRIED)
    monkeypatch.setattr("certnav.nav.tune.settings.candidates", lambda *_: few)
    pytest.importorskip("distributed")
    monkeypatch.chdir(drives[0].parent)
    here = [Path(drive.name) for drive in drives]  # relative, and the workers are elsewhere
    expected = strict(job(here, jobs=2))
    with sweeps.cluster(tmp_path) as (address, workers), Killing(address, workers) as killing:
        found = strict(job(here, scheduler=address))
    assert killing.killed
    assert json.dumps(found, sort_keys=True) == json.dumps(expected, sort_keys=True)
