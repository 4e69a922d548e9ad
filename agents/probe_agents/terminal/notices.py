"""Message about compilation, printed above the progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event
from tqdm import tqdm


class _Once(event.Listener):
    """Prints a message at the first kernel that is not in numba's cache."""

    announced = False

    def on_start(self, event: Any) -> None:
        if not self.announced:
            self.announced = True
            tqdm.write("compiling kernels; later runs use the cache", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def announce_compilation() -> Iterator[None]:
    """Context that prints a message when a kernel is compiled, which takes seconds to a minute."""
    with event.install_listener("numba:compile", _Once()):
        yield
