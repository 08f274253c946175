"""Graceful shutdown of an API process: finish the requests in flight, answer new jobs with 503, then exit."""

from __future__ import annotations

from ..problems import Problem

RETRY_SECONDS = 10


class Shutdown:
    """Whether this process is stopping, and how many earlier requests are still in flight.

    Attributes
    ----------
    begun : bool
    in_flight : int
    """

    def __init__(self) -> None:
        self.begun = False
        self.in_flight = 0

    def begin(self) -> None:
        """Refuse new jobs from here on."""
        self.begun = True

    def check_open(self) -> None:
        """Refuse a new job once this process stops.

        Raises
        ------
        Problem
            503 ``stopping``.
        """
        if self.begun:
            raise Problem(
                "stopping",
                "The service is stopping and takes no new jobs. Accepted jobs continue after the next start.",
                hint="Send the file again after the number of seconds in Retry-After.",
                headers={"Retry-After": str(RETRY_SECONDS)},
            )
