"""Who records and assembles a collection: processes of this machine, or actors of a cluster."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Protocol

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.record import RecordingJob, recording_session, writing_session
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.encoding import EpisodeFile, Features, preparing_session
from lerobot_adamanip.util.jobs import Executor, WorkerPool

MIN_PREPARED = 32
"""A process more has to have so many episodes to prepare: it imports LeRobot first, for the time of ten."""


class ExecutorFactory(Protocol):
    """Makes an executor for each half of a collection."""

    def recording(self, job: RecordingJob, paths: CollectionPaths, items: int) -> Executor[EpisodeSpec]:
        """Returns who records: the value of a result is an `ItemReport` if it is written, else an `ItemOutcome`."""
        ...

    def preparing(self, features: Features, fps: int, items: int) -> Executor[EpisodeFile] | None:
        """Returns who prepares episodes for assembly: `PreparedEpisode`; None if this process had better do it."""
        ...


class ProcessCrews:
    """Processes of this machine, which write what they have recorded themselves.

    Args:
        workers: processes.
        timeout: one without a heartbeat for so long is replaced [s].
    """

    def __init__(self, workers: int, timeout: float) -> None:
        self._workers, self._timeout = workers, timeout

    def recording(self, job: RecordingJob, paths: CollectionPaths, items: int) -> Executor[EpisodeSpec]:
        """See `ExecutorFactory`."""
        session = functools.partial(writing_session, job, paths)
        return WorkerPool[EpisodeSpec](session, min(self._workers, max(1, items)), timeout=self._timeout)

    def preparing(self, features: Features, fps: int, items: int) -> Executor[EpisodeFile] | None:
        """See `ExecutorFactory`."""
        workers = min(self._workers, items // MIN_PREPARED)
        session = functools.partial(preparing_session, features, fps)
        return WorkerPool[EpisodeFile](session, workers, timeout=self._timeout) if workers > 1 else None


class ClusterCrews:
    """Actors of the cluster that this process is connected to; the driver alone writes.

    Args:
        workers: actors.
        timeout: an item that takes longer is begun anew by another one [s].
    """

    def __init__(self, workers: int, timeout: float) -> None:
        self._workers, self._timeout = workers, timeout

    def recording(self, job: RecordingJob, paths: CollectionPaths, items: int) -> Executor[EpisodeSpec]:
        """See `ExecutorFactory`."""
        from lerobot_adamanip.collection.ray_executor import RayExecutor

        session = functools.partial(recording_session, job)
        workers = min(self._workers, max(1, items))
        return RayExecutor[EpisodeSpec](session, workers, timeout=self._timeout, category=_category)

    def preparing(self, features: Features, fps: int, items: int) -> Executor[EpisodeFile] | None:
        """See `ExecutorFactory`."""
        from lerobot_adamanip.collection.ray_executor import RayExecutor

        workers = min(self._workers, items // MIN_PREPARED)
        session = functools.partial(preparing_session, features, fps)
        if workers < 2:
            return None
        return RayExecutor[EpisodeFile](session, workers, timeout=self._timeout, load=_content)


def _category(item: EpisodeSpec) -> str:
    return category_of(item.object_id)


def _content(item: EpisodeFile) -> bytes:
    return item.path.read_bytes()


@contextlib.contextmanager
def open_executors(
    workers: int, timeout: float, *, cluster: str | None = None, insecure: bool = False
) -> Iterator[ExecutorFactory]:
    """Yields who does the work, connected to ``cluster`` meanwhile, if given; ``workers`` 0: one per CPU of it."""
    if cluster is None:
        yield ProcessCrews(workers, timeout)
        return
    from lerobot_adamanip.collection.ray_cluster import connected

    with connected(cluster, workers=workers, insecure=insecure) as cpus:
        yield ClusterCrews(workers or max(1, cpus), timeout)
