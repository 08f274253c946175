"""Names that the API and the worker use with DBOS, the job engine. They are persisted and must not change."""

from __future__ import annotations

from dbos import DBOSPortableJSONSerializer

APPLICATION_NAME = "pcdnf"
# Fixed by hand: the queued and half-done jobs of an older release are taken up by the next one. Raise it only when
# the steps of the workflow or the files between them change meaning.
APPLICATION_VERSION = "1"
WORKFLOW = "denoise"
SHARD_WORKFLOW = "denoise_share"
GIVEN_UP = ["ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED"]
SERIALIZER = DBOSPortableJSONSerializer()  # the engine's default is pickle
