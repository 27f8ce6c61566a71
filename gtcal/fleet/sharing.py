"""A job on a worker of a cluster, whose detection in many images all workers share, by ranges of the images: one long
recording gains from every node too, not only many recordings.

The worker that has the job waits for the others, its own core given up meanwhile, and puts together what they saw.
What is found is the same as where it is not divided, image by image. Each worker reads the recording by its manifest,
once, and then the images of its ranges: files, or a stretch of a video or a bag."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from uuid import uuid4

from gtcal.detection.many_images import Looking, Seen, Tasks, look_at_each, looked_at_by
from gtcal.errors import GtcalError
from gtcal.fleet.run_job import LostWorkersError, Outcome, Task, run_task
from gtcal.recordings.images import Images
from gtcal.recordings.manifest import load_fields

PER_RANGE = 60
"""Images of a range: some seconds of one core."""


def run_shared(task: Task) -> Outcome:
    """As ``run_task``, on a worker of a Dask cluster, which may share the detection with the others."""
    once = uuid4().hex  # what is read for this is not what was read another day
    with looked_at_by(partial(_look_at_shared, task.job.recordings, once)):
        return run_task(task)


def _look_at_shared(
    manifests: tuple[Path, ...], once: str, images: Images, tasks: Tasks, looking: Looking
) -> Iterator[tuple[int, Seen]]:
    """Each index and what its image shows, in the order in which they are done.

    Raises LostWorkersError where those who looked were killed, as often as it was tried."""
    from distributed import KilledWorker, as_completed, worker_client

    assert looking.camera is not None  # images of a recording have one
    ordered = sorted(tasks, key=lambda each: each[0])
    ranges = [ordered[start : start + PER_RANGE] for start in range(0, len(ordered), PER_RANGE)]
    look = partial(look_at_range, manifests, once, looking.camera.name, _mark(images), looking)
    with worker_client(timeout="60s") as client:
        futures = client.map(look, ranges, pure=False, priority=1)  # before other jobs: this one was begun
        try:
            for _, seen in as_completed(futures, with_results=True):
                yield from seen
        except KilledWorker as error:
            raise LostWorkersError from error


def look_at_range(
    manifests: tuple[Path, ...], once: str, camera: str, mark: str, looking: Looking, tasks: Tasks
) -> list[tuple[int, Seen]]:
    """What the images of a range show, on the worker that has it. once: by which a worker knows what it has read
    already. mark: of these images among those of all the job's recordings.

    Raises GtcalError where the recording is no longer what it was when the job was begun."""
    found = _images(manifests, once, camera, mark)
    if looking.camera is not None:
        found = found.expecting(looking.camera.image_width_px, looking.camera.image_height_px)
    return list(look_at_each(found, tasks, looking))


def _mark(images: Images) -> str:
    """What tells a camera's images from those of another recording."""
    return f"{images.files[0]} {images.source} {len(images)} {images.stamps_ns[0]} {images.stamps_ns[-1]}"


def _images(manifests: tuple[Path, ...], once: str, camera: str, mark: str) -> Images:
    for manifest in manifests:
        found = _images_in(manifest, once).get(camera)
        if found is not None and _mark(found) == mark:
            return found
    raise GtcalError(f"{manifests[0]}: the images of {camera} have changed while they were looked at")


@lru_cache(maxsize=2)
def _images_in(manifest: Path, once: str) -> dict[str, Images]:
    from gtcal.recordings.recording import load_recording
    from gtcal.verification.lollypop_recording import load_lollypop_recording

    load = load_lollypop_recording if "device" in load_fields(manifest) else load_recording
    return load(manifest).images
