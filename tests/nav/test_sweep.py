"""Sweeps: the same results in the same order, here, in processes and on a cluster."""

import functools
import os
import warnings

import numpy as np
import pytest

from certnav.filters.errors import ConfigError
from certnav.nav.sweep import in_order, in_parallel

CALLS = [(3,), (1,), (2,), (0,)]
POWERS = functools.partial(pow, 2)


def test_results_come_in_the_order_of_the_calls():
    for jobs in (1, 2):
        assert list(in_parallel(POWERS, CALLS, jobs=jobs)) == [8, 2, 4, 1]
    assert list(in_parallel(POWERS, [])) == []


def test_one_job_starts_no_process():
    assert list(in_parallel(lambda x: x, [(k,) for k in range(3)], jobs=1)) == [0, 1, 2]


def test_a_dask_cluster_is_sent_what_is_shared_once():
    distributed = pytest.importorskip("distributed")
    big = np.arange(1000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask's own
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster:
            found = in_parallel(
                np.take, [(big, k) for k in (5, 7)],
                scheduler=cluster.scheduler_address, shared=[big],
            )  # fmt: skip
            assert [float(x) for x in found] == [5.0, 7.0]


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
