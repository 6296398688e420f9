"""Sweeps: the same results in the same order, here, in processes and on a cluster."""

import functools
import os
import warnings

import numpy as np
import pytest

from certnav.filters.errors import ConfigError, NavError
from certnav.nav.sweep.cluster import planned
from certnav.nav.sweep.drives import volume_of
from certnav.nav.sweep.parallel import in_order, in_parallel
from certnav.nav.sweep.shared import Shared, itself
from oracles import sweeps

CALLS = [(3,), (1,), (2,), (0,)]
POWERS = functools.partial(pow, 2)
pytestmark = pytest.mark.filterwarnings("ignore")  # Dask's own


@pytest.fixture
def cluster(tmp_path):
    pytest.importorskip("distributed")
    with sweeps.cluster(tmp_path) as (address, workers):
        yield address, workers


def test_results_come_in_the_order_of_the_calls():
    for jobs in (1, 2):
        assert list(in_parallel(POWERS, CALLS, jobs=jobs)) == [8, 2, 4, 1]
    assert list(in_parallel(POWERS, [])) == []


def test_one_job_starts_no_process():
    assert list(in_parallel(lambda x: x, [(k,) for k in range(3)], jobs=1)) == [0, 1, 2]


def test_what_is_shared_is_made_once_for_the_calls_that_follow_one_another(tmp_path):
    drives = [Shared(sweeps.made, (tmp_path, name, 100)) for name in "ab"]
    calls = [(tmp_path, drive, number) for drive in drives for number in range(3)]
    expected = list(in_parallel(sweeps.worked, calls, jobs=1))
    assert sweeps.marks(tmp_path, "*.made") == [os.getpid()] * 2
    in_memory = [Shared(itself, (drive.value(),)) for drive in drives]
    calls = [(tmp_path, drive, number) for drive in in_memory for number in range(3)]
    assert list(in_parallel(sweeps.worked, calls, jobs=1)) == expected


def test_drives_are_sent_whole_and_the_largest_first(tmp_path):
    drives = [Shared(itself, (name,), volume) for name, volume in (("s", 1.0), ("l", 9.0))]
    judge = Shared(itself, (None,))
    calls = [(k, drive, judge) for k in range(2) for drive in drives]  # s l s l
    assert planned(calls) == [1, 3, 0, 2]
    assert planned([(1,), (2,)]) == [0, 1]
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "a").write_bytes(b"x" * 1000)
    assert volume_of(tmp_path / "drive") == volume_of(tmp_path / "drive" / "a") == 1000


def test_a_cluster_finds_the_same_and_makes_what_is_shared_where_it_is_needed(tmp_path, cluster):
    address, workers = cluster
    drives = [Shared(sweeps.made, (tmp_path, name, 100), ord(name)) for name in "ab"]
    calls = [(tmp_path, drive, number) for drive in drives for number in range(6)]
    found = list(in_parallel(sweeps.worked, calls, scheduler=address))
    pids = {worker.pid for worker in workers}
    assert len(sweeps.marks(tmp_path, "?.made")) == 2  # once each, sent on from worker to worker
    assert {*sweeps.marks(tmp_path, "*.done")} == pids
    assert found == list(in_parallel(sweeps.worked, calls, jobs=1))


def test_a_worker_that_is_killed_takes_nothing_with_it(tmp_path, cluster):
    """Also not what it has made for others, or results that nobody has fetched yet."""
    address, workers = cluster
    big = Shared(itself, (np.arange(2e5),))  # in memory here, 1.6 MB
    drives = [Shared(sweeps.made, (tmp_path, name, 100), ord(name)) for name in "abcd"]
    calls = [(tmp_path, drive, number) for drive in (*drives, big) for number in range(8)]
    found = []
    for result in in_parallel(sweeps.worked, calls, scheduler=address):
        found.append(result)
        if len(found) == 1:
            first = sweeps.marks(tmp_path, "*.made")[0]
            (victim,) = (w for w in workers if w.pid == first)
            victim.kill()
            victim.wait()
    assert found == list(in_parallel(sweeps.worked, calls, jobs=1))
    assert {w.pid for w in workers} == {*sweeps.marks(tmp_path, "*.done")} - {os.getpid()}


def test_a_call_that_kills_worker_after_worker_ends_in_one_line(cluster):
    address, _ = cluster
    with pytest.raises(NavError, match="2 workers have died") as caught:
        list(in_parallel(sweeps.deadly, [(1,)], scheduler=address))
    assert "\n" not in str(caught.value)


def test_what_a_call_refuses_is_refused_here_as_it_is_said(cluster):
    address, _ = cluster
    with pytest.raises(ZeroDivisionError):
        list(in_parallel(divmod, [(1, 1), (1, 0)], scheduler=address))


def test_no_scheduler_there_is_one_line():
    pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ConfigError, match="no Dask scheduler there") as caught:
            list(in_parallel(POWERS, CALLS, scheduler="tcp://127.0.0.1:9"))
    assert "\n" not in str(caught.value)


def test_threads_keep_the_order_and_never_run_far_ahead():
    taken, ahead = [], 0

    def items():
        for k in range(200):
            taken.append(k)
            yield k

    for done, result in enumerate(in_order(lambda k: k * k, items())):
        assert result == done * done
        ahead = max(ahead, len(taken) - done)
    assert len(taken) == 200
    assert ahead <= (os.cpu_count() or 1) + 1


def test_what_goes_wrong_in_a_thread_is_raised():
    with pytest.raises(ZeroDivisionError):
        list(in_order(lambda k: 1 // k, [1, 0, 1]))
