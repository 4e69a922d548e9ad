"""A strict interpreter of the structured text that the project writes: what it does not know is an error.

It knows function blocks of REAL, INT and BOOL with assignments, IF ... ELSE, FOR, and the standard functions that the
law uses, every operation rounded to single precision as a PLC's REAL is.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

TOKEN = re.compile(r"\s*(?:(\d+\.\d+|\d+)|([A-Za-z_]\w*)|(:=|<=|>=|<>|[-+*/();,<>=:]))")
SECTIONS = ("VAR_INPUT", "VAR_OUTPUT", "VAR")
TYPES = {"REAL": np.float32(0.0), "INT": 0, "BOOL": False}
ONE = np.float32(1.0)
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "EXP": np.exp, "LN": np.log, "MAX": max, "MIN": min, "LIMIT": lambda low, x, high: min(max(x, low), high),
}  # fmt: skip
OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b,
    "<": lambda a, b: a < b, ">": lambda a, b: a > b,
}  # fmt: skip


class FunctionBlock:
    """A function block: call it with its inputs by name; outputs and state are in ``values``."""

    def __init__(self, text: str) -> None:
        self.tokens = _tokens(text)
        self.place, self.values, self.inputs, self.fixed = 0, {}, set(), set()
        self.take("FUNCTION_BLOCK")
        self.name = self.take()
        while self.now in SECTIONS:
            self._declare()
        self.start = self.place
        self._run(False)  # parses all of it
        self.take("END_FUNCTION_BLOCK")
        if self.place != len(self.tokens):
            raise SyntaxError(f"after END_FUNCTION_BLOCK: {self.now}")

    @property
    def now(self) -> str:
        return self.tokens[self.place] if self.place < len(self.tokens) else ""

    def take(self, wanted: str = "") -> str:
        token = self.now
        if not token or (wanted and token != wanted):
            raise SyntaxError(f"{token!r} where {wanted or 'something'!r} must stand")
        self.place += 1
        return token

    def __call__(self, **inputs: Any) -> dict[str, Any]:
        if set(inputs) != self.inputs:
            raise TypeError(f"inputs are {sorted(self.inputs)}, not {sorted(inputs)}")
        self.values |= {name: v if isinstance(v, bool) else np.float32(v) for name, v in inputs.items()}
        self.place = self.start
        self._run(True)
        return self.values

    def _declare(self) -> None:
        section = self.take()
        constant = self.now == "CONSTANT" and bool(self.take())
        while self.now != "END_VAR":
            name = self.take()
            self.take(":")
            kind = self.take()
            if name in self.values or kind not in TYPES:
                raise SyntaxError(f"{name} : {kind}")
            value = TYPES[kind]
            if self.now == ":=":
                self.take()
                value = np.float32(self.take())
            elif constant:
                raise SyntaxError(f"{name} is constant and has no value")
            self.values[name] = value
            self.take(";")
            (self.inputs if section == "VAR_INPUT" else self.fixed if constant else set()).add(name)
        self.take("END_VAR")

    def _run(self, act: bool) -> None:
        """Statements up to what ends them; parsed only, unless ``act``."""
        while self.now not in ("END_IF", "ELSE", "END_FOR", "END_FUNCTION_BLOCK"):
            if self.now == "IF":
                self._branch(act)
            elif self.now == "FOR":
                self._loop(act)
            else:
                self._assign(act)

    def _branch(self, act: bool) -> None:
        self.take("IF")
        holds = self._compared()
        self.take("THEN")
        self._run(act and bool(holds))
        if self.now == "ELSE":
            self.take()
            self._run(act and not holds)
        self.take("END_IF")
        self.take(";")

    def _loop(self, act: bool) -> None:
        self.take("FOR")
        counter = self.take()
        self.take(":=")
        low = int(self.take())
        self.take("TO")
        high = int(self.take())
        self.take("DO")
        begin = self.place
        for value in range(low, high + 1 if act else low + 1):
            self.place = begin
            self.values[counter] = value
            self._run(act)
        self.take("END_FOR")
        self.take(";")

    def _assign(self, act: bool) -> None:
        name = self.take()
        if name not in self.values or name in self.fixed | self.inputs:
            raise SyntaxError(f"{name} cannot be assigned to")
        self.take(":=")
        value = self._compared()
        self.take(";")
        if act:
            self.values[name] = value

    def _compared(self) -> Any:
        left = self._sum()
        return OPERATORS[self.take()](left, self._sum()) if self.now in ("<", ">") else left

    def _sum(self) -> Any:
        value = self._product()
        while self.now in ("+", "-"):
            value = self._rounded(OPERATORS[self.take()], value, self._product())
        return value

    def _product(self) -> Any:
        value = self._single()
        while self.now in ("*", "/"):
            value = self._rounded(OPERATORS[self.take()], value, self._single())
        return value

    def _single(self) -> Any:
        token = self.take()
        if token == "-":
            return -self._single()
        if token == "(":
            value = self._compared()
            self.take(")")
            return value
        if token[0].isdigit():
            return np.float32(token)
        if token in FUNCTIONS:
            self.take("(")
            arguments = [self._compared()]
            while self.now == ",":
                self.take()
                arguments.append(self._compared())
            self.take(")")
            return self._rounded(FUNCTIONS[token], *arguments)
        if token not in self.values:
            raise SyntaxError(f"{token!r} is not known")
        return self.values[token]

    def _rounded(self, operation: Callable[..., Any], *arguments: Any) -> np.float32:
        with np.errstate(all="ignore"):  # parsing goes through branches that are not taken, with zeros
            return np.float32(operation(*arguments))


def _tokens(text: str) -> list[str]:
    bare, place, tokens = re.sub(r"\(\*.*?\*\)", " ", text, flags=re.DOTALL).strip(), 0, []
    while place < len(bare):
        match = TOKEN.match(bare, place)
        if match is None:
            raise SyntaxError(f"{bare[place : place + 20]!r} is no structured text")
        tokens.append(next(filter(None, match.groups())))
        place = match.end()
    return tokens


def block_inputs(row: dict[str, np.ndarray], period: float, start: bool) -> dict[str, float]:
    """What a function block of the law is called with, of one probe's measurements (1,) each."""
    measured = {
        "InsertedLength": "inserted_length", "RootTension": "root_tension", "Noise": "rf_noise",
        "FeedNow": "feed_speed", "AirNow": "air_supply_rate", "HelixDiameter": "helix_diameter",
    }  # fmt: skip
    return {"Start": start, "Period": period} | {name: float(row[field][0]) for name, field in measured.items()}
