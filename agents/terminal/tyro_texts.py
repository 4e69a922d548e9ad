"""What tyro prints as text of ours: boxes as one line, docstrings as paragraphs, a mistyped option with its likes."""

from __future__ import annotations

import difflib
import re
import shutil
import textwrap
from collections.abc import Sequence
from typing import Final

FRAME: Final = "│ "
RULE: Final = re.compile(r"[╭╰─-][─-]*.*[╮╯─-]")
"""A line below a title, around a box, or before what every help says."""
LAID: Final = "\u2060"
"""Begins what has its breaks already: a mark that is not seen."""
LIKES: Final = 3
"""Most options that are offered for a mistyped one."""
_OPTION: Final = re.compile(r"(?:^|[ ,])(--?[A-Za-z][\w.-]*)")


def joined_lines(helptext: str) -> str:
    """A docstring as paragraphs of one line each: lines break where the terminal ends, not where the source does."""
    if LAID in helptext:
        return helptext.replace(LAID, "")
    paragraphs = re.split(r"\n[ \t]*\n", helptext.strip())
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def laid_out(text: str) -> str:
    """A text with breaks where the terminal ends, which tyro prints as it is: it breaks no lines above its boxes."""
    width = shutil.get_terminal_size().columns
    return LAID + "\n\n".join(textwrap.fill(paragraph, width) for paragraph in joined_lines(text).split("\n\n"))


def message_of(box: str) -> str:
    """The message of an error, which stands below the first rule, or in a box, as one line."""
    lines = [line.strip(FRAME) for line in box.splitlines() if line.strip()]
    rules = [k for k, line in enumerate(lines) if RULE.fullmatch(line)] + [len(lines)]
    begin, end = rules[:2] if len(rules) > 1 else (-1, len(lines))
    return " ".join(" ".join(lines[begin + 1 : end]).split())


def options_of(page: str) -> tuple[str, ...]:
    """The options that a page of help lists."""
    lines = [line.strip(FRAME) for line in page.splitlines()]
    names = [_OPTION.findall(re.split(r"\s{2,}", line)[0]) for line in lines if line.startswith("-")]
    return tuple(dict.fromkeys(name for matches in names for name in matches))


def option_problem(given: str, known: Sequence[str], command: str) -> str:
    """That an option is not known, and which may be meant: all of the same model, else the most similar.

    Args:
        given: the option, without a value.
        known: those that there are.
        command: whose options they are.
    """
    model = given.rpartition(".")[0]
    beside = [name for name in known if model and name.rpartition(".")[0] == model]
    similar = difflib.get_close_matches(given, known, LIKES)
    if beside:
        nearest = sorted(beside, key=lambda name: (-difflib.SequenceMatcher(None, given, name).ratio(), name))
        names = ", ".join(name.rpartition(".")[2] for name in nearest)
        likely = f"; accepted behind {model}.: {names}"
    else:
        likely = f"; the closest: {', '.join(similar)}" if similar else ""
    return f"there is no option {given}{likely} (probe-env {command} --help tells all)"
