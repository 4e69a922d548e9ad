"""What a command says of itself while it runs, above its progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event
from tqdm import tqdm


class _Once(event.Listener):
    """Says that kernels are compiled, at the first one that is not in numba's cache."""

    announced = False

    def on_start(self, event: Any) -> None:
        if not self.announced:
            self.announced = True
            tqdm.write("compiling kernels, which are kept for later runs", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def announce_compilation() -> Iterator[None]:
    """Say so when a kernel has to be compiled while it is entered: that takes seconds to a minute."""
    with event.install_listener("numba:compile", _Once()):
        yield
