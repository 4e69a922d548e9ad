"""A strict interpreter of the structured text that the project writes: what it does not know is an error.

It knows function blocks of REAL, INT and BOOL with assignments, IF ... ELSE, FOR, and the standard functions that the
law uses. They are translated to Python, with every operation rounded to single precision as a PLC's REAL is.
"""

import re
from typing import Any

import numpy as np

TOKEN = re.compile(r"\s*(?:(\d+\.\d+|\d+)|([A-Za-z_]\w*)|(:=|<=|>=|<>|[-+*/();,<>=:]))")
SECTIONS = ("VAR_INPUT", "VAR_OUTPUT", "VAR")
TYPES = {"REAL": np.float32(0.0), "INT": 0, "BOOL": False}
FUNCTIONS = {
    "EXP": np.exp, "SQRT": np.sqrt, "LN": np.log, "MAX": max, "MIN": min,
    "LIMIT": lambda low, x, high: min(max(x, low), high),
}  # fmt: skip
OPERATORS = frozenset("+-*/<>(),") | {">="}


class FunctionBlock:
    """A function block: call it with its inputs by name; outputs and state are in ``values``."""

    def __init__(self, text: str) -> None:
        self.tokens = _tokens(text)[::-1]  # the next one is the last
        self.values: dict[str, Any] = {}
        self.inputs: set[str] = set()
        self.fixed: set[str] = set()
        self.take("FUNCTION_BLOCK")
        self.name = self.take()
        while self.tokens[-1] in SECTIONS:
            self._declare()
        self.code = compile("\n".join(self._statements()), self.name, "exec")
        if self.tokens:
            raise SyntaxError(f"after END_FUNCTION_BLOCK: {self.tokens[-1]}")

    def take(self, wanted: str = "") -> str:
        token = self.tokens.pop() if self.tokens else ""
        if not token or (wanted and token != wanted):
            raise SyntaxError(f"{token!r} where {wanted or 'something'!r} must stand")
        return token

    def __call__(self, **inputs: Any) -> dict[str, Any]:
        if set(inputs) != self.inputs:
            raise TypeError(f"inputs are {sorted(self.inputs)}, not {sorted(inputs)}")
        self.values |= {name: v if isinstance(v, bool) else np.float32(v) for name, v in inputs.items()}
        with np.errstate(all="ignore"):
            exec(self.code, {"values": self.values, "real": np.float32} | FUNCTIONS)
        return self.values

    def _declare(self) -> None:
        section = self.take()
        constant = self.tokens[-1] == "CONSTANT" and bool(self.take())
        while self.tokens[-1] != "END_VAR":
            name = self.take()
            self.take(":")
            kind = self.take()
            if name in self.values or kind not in TYPES:
                raise SyntaxError(f"{name} : {kind}")
            self.values[name] = TYPES[kind]
            if self.tokens[-1] == ":=":
                self.take()
                self.values[name] = np.float32(self.take())
            elif constant:
                raise SyntaxError(f"{name} is constant and has no value")
            self.take(";")
            (self.inputs if section == "VAR_INPUT" else self.fixed if constant else set()).add(name)
        self.take("END_VAR")

    def _statements(self) -> list[str]:
        """Lines of Python up to the end of the block."""
        lines: list[str] = []
        opened: list[str] = []

        def add(line: str) -> None:
            lines.append("    " * len(opened) + line)

        def begin(line: str, end: str) -> None:
            add(line)
            opened.append(end)
            add("pass")

        while (token := self.take()) != "END_FUNCTION_BLOCK" or opened:
            if token == "IF":
                begin(f"if {self._expression('THEN')}:", "END_IF")
            elif token == "FOR":
                name = self._target(self.take())
                low, high = self._expression("TO"), self._expression("DO")
                begin(f"for {name} in range(int({low}), int({high}) + 1):", "END_FOR")
            elif token == "ELSE" and opened[-1:] == ["END_IF"]:
                opened.pop()
                begin("else:", "END_IF")
            elif opened and token == opened[-1]:
                opened.pop()
                self.take(";")
            else:
                add(f"{self._target(token)} = {self._expression(';')}")
        return lines

    def _target(self, name: str) -> str:
        if name not in self.values or name in self.fixed | self.inputs:
            raise SyntaxError(f"{name} cannot be assigned to")
        self.take(":=")
        return f"values[{name!r}]"

    def _expression(self, end: str) -> str:
        """Python of what stands before a token, which is taken as well."""
        parts = []
        while (token := self.take()) != end:
            if token[0].isdigit():
                parts.append(f"real({token!r})")
            elif token in OPERATORS or token in FUNCTIONS:
                parts.append(token)
            elif token in self.values:
                parts.append(f"real(values[{token!r}])")
            else:
                raise SyntaxError(f"{token!r} is not known")
        return " ".join(parts)


def _tokens(text: str) -> list[str]:
    bare = re.sub(r"\(\*.*?\*\)", " ", text, flags=re.DOTALL).strip()
    if unknown := TOKEN.sub("", bare).strip():
        raise SyntaxError(f"{unknown!r} is no structured text")
    return ["".join(groups) for groups in TOKEN.findall(bare)]


def block_inputs(row: dict[str, np.ndarray], period: float, start: bool) -> dict[str, float]:
    """What a function block of the law is called with, of one probe's measurements (1,) each."""
    measured = {
        "InsertedLength": "inserted_length", "RootTension": "root_tension", "Noise": "rf_noise",
        "FeedNow": "feed_speed", "AirNow": "air_supply_rate", "HelixDiameter": "helix_diameter",
    }  # fmt: skip
    return {"Start": start, "Period": period} | {name: float(row[field][0]) for name, field in measured.items()}
