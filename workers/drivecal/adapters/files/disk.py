"""Limits of the files in a session's scratch folder."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from drivecal.adapters.files import usage

MOST_DISK_MB = 16_384
"""Limit of the files in a scratch folder. If less of the disk is free when the session opens, nine tenths of that."""
MOST_FILES = 1_000_000
"""Limit of the files and folders in a scratch folder."""
NOTICED_MB, NOTICED_FILES = 64, 10_000
"""Loss of the disk's free room after which the files in the scratch folder are counted."""
SCARCE = 0.05
"""Share of a disk: if less is free, a session whose files take more than that ends, because several fill a disk together."""


@dataclass(frozen=True, slots=True)
class Room:
    """Free megabytes and files of a disk, and whether it is almost full."""

    megabytes: int
    files: int
    is_scarce: bool = False

    @classmethod
    def of(cls, folder: Path) -> Room:
        """Returns what is free on a folder's disk."""
        disk = os.statvfs(folder)
        return cls(disk.f_bavail * disk.f_frsize >> 20, disk.f_favail, disk.f_bavail < SCARCE * disk.f_blocks)

    def lost(self, since: Room) -> bool:
        """Returns whether the disk has lost so much since then that files are worth counting."""
        return self.megabytes <= since.megabytes - NOTICED_MB or self.files <= since.files - NOTICED_FILES


class Disk:
    """The disk below a scratch folder. Files of the session count if they have no name as well, as long as a process has them."""

    def __init__(self, folder: Path, memory_mb: int) -> None:
        """`memory_mb`: the limit of the session's memory, which holds for its files as well if these lie in memory."""
        self._folder = folder
        self._counted = self._opened = Room.of(folder)
        """The room at the last count, and when the session opened."""
        self._most_mb = min(MOST_DISK_MB, self._opened.megabytes * 9 // 10)
        if usage.is_in_memory(str(folder)):
            self._most_mb = min(self._most_mb, memory_mb)

    def excess(self, processes: Collection[int]) -> str | None:
        """Returns how the files exceed a limit, None if they do not. They are counted only if the disk has lost room or is almost full.

        `processes`: the number of a living thread of each process of the session.
        """
        room = Room.of(self._folder)
        if not room.lost(self._counted) and not room.is_scarce:
            return None
        try:
            taken, files = usage.written(str(self._folder), MOST_FILES)
            nameless = usage.nameless(processes, str(self._folder))
            mapped = usage.mapped(processes, str(self._folder))
        except usage.UncountableError as error:
            return f"its files cannot be counted: {error}"
        taken += sum((mapped | nameless.on_disk).values())
        taken >>= 20
        self._counted = room
        if room.is_scarce and taken > max(NOTICED_MB, room.megabytes):
            return f"its files take {taken:,} MB of a disk that has {room.megabytes:,} MB left"
        if room.is_scarce and not nameless.is_complete and room.lost(self._opened):
            return f"it hides its open files, and the disk has {room.megabytes:,} MB left"
        if taken > self._most_mb or files > MOST_FILES:
            most = f"{self._most_mb:,} MB or {MOST_FILES:,} files"
            return f"its files take {taken:,} MB of disk ({files:,} files), more than {most}"
        return None
