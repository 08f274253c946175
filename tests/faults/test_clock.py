"""The clock of the machine jumps, by an hour and by two days, while a job runs."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.apart import TILE, Apart, succeeded, until
from tests.support.service_process import write_sphere

PRELOADED = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long jump(void) {
    char text[32] = {0};
    int file = open(getenv("CLOCK_JUMP"), O_RDONLY);
    if (file >= 0) { if (read(file, text, sizeof text - 1) < 0) text[0] = 0; close(file); }
    return atol(text);
}
int clock_gettime(clockid_t id, struct timespec *t) {
    int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, t);
    if (id == CLOCK_REALTIME) t->tv_sec += jump();
    return result;
}
int gettimeofday(struct timeval *t, void *zone) {
    struct timespec now;
    (void) zone;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}
time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}
"""
HOUR = 3600


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler, for a clock that can be set")
def test_jumps_of_the_clock(tmp_path: Path) -> None:
    (tmp_path / "clock.c").write_text(PRELOADED)
    library = tmp_path / "clock.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, tmp_path / "clock.c", "-ldl"], check=True)
    clock = tmp_path / "clock"

    def jump(seconds: int) -> None:
        (tmp_path / "next").write_text(str(seconds))
        (tmp_path / "next").replace(clock)

    jump(0)
    service = Apart(tmp_path / "service", tile_points=TILE, worker_stale_seconds=3)
    service.environment |= {"LD_PRELOAD": str(library), "CLOCK_JUMP": str(clock)}
    service.start()
    path = write_sphere(tmp_path / "a.ply", 6 * TILE)
    kept = None
    for seconds in (HOUR, -HOUR, 0):
        job = service.submit(path)["id"]
        until(lambda job=job: service.job(job)["progress"]["done"] >= TILE)
        jump(seconds)
        result = succeeded(service, job)
        assert kept in (None, result)
        kept = result
        assert service.job(job)["seconds_left"] is None
        service.wait_ready()
    first = job
    assert len(service.client.get("/jobs").json()) == 3
    job = service.submit(path)["id"]
    until(lambda: service.job(job)["progress"]["done"] >= TILE)
    jump(48 * HOUR)  # what had finished has expired then, what runs has not
    assert succeeded(service, job) == kept
    assert service.client.get(f"/jobs/{first}").status_code == 410
    assert service.stop() == 0, service.output()
