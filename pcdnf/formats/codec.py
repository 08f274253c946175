"""The interface of a format: how to recognise, read and write its files, and what they can hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO, Protocol

from ..file_formats import FORMATS
from .limits import Limits
from .point_cloud import PointCloud


class Codec(Protocol):
    """Reads and writes one format.

    Attributes
    ----------
    name : str
        A key of :data:`pcdnf.file_formats.FORMATS`.
    holds_holes : bool
        Whether rows without coordinates have a place in a file.
    rounding : float
        How far coordinates move at most when they are stored, as a share of the distance of neighbours.
    """

    @property
    def name(self) -> str:
        """Return the key of the format."""
        ...

    @property
    def holds_holes(self) -> bool:
        """Return whether rows without coordinates have a place in a file."""
        ...

    @property
    def rounding(self) -> float:
        """Return how far coordinates move at most, as a share of the distance of neighbours."""
        ...

    def sniff(self, head: bytes) -> bool:
        """Return whether a file that begins with `head` has this format."""
        ...

    def read(self, file: BinaryIO, size: int, limits: Limits) -> PointCloud:
        """Read a file of `size` bytes that is open at its first byte.

        Raises
        ------
        FormatError
            If the file breaks a rule of its format or a limit.
        """
        ...

    def arrange(self, cloud: PointCloud) -> tuple[PointCloud, list[str]]:
        """Return the cloud in the order that the format requires, and sentences on the change."""
        ...

    def write(self, file: BinaryIO, cloud: PointCloud) -> list[str]:
        """Write a cloud, and return sentences on what the format could not carry.

        Raises
        ------
        FormatError
            If the format cannot hold the cloud.
        """
        ...


@dataclass(frozen=True)
class FileCodec:
    """A :class:`Codec` of a reader and a writer; a format is recognised by its first bytes."""

    name: str
    reader: Callable[[BinaryIO, int, Limits], PointCloud]
    writer: Callable[[BinaryIO, PointCloud], list[str]]
    holds_holes: bool = True
    rounding: float = 1e-9
    arranger: Callable[[PointCloud], tuple[PointCloud, list[str]]] | None = None

    def sniff(self, head: bytes) -> bool:
        """Whether a file that begins with ``head`` is of this format; never for columns of text."""
        return head.startswith(FORMATS[self.name].magic)

    def read(self, file: BinaryIO, size: int, limits: Limits) -> PointCloud:
        """Read a file of ``size`` bytes that is open at its first byte."""
        return self.reader(file, size, limits)

    def arrange(self, cloud: PointCloud) -> tuple[PointCloud, list[str]]:
        """Return the cloud in the order that the format requires, and sentences on the change."""
        return (cloud, []) if self.arranger is None else self.arranger(cloud)

    def write(self, file: BinaryIO, cloud: PointCloud) -> list[str]:
        """Write a cloud."""
        return self.writer(file, cloud)
