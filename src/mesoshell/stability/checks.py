"""One thing that may be hard about a scene: what was tried, the worst that was found, and the bound on it."""

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Check:
    """name: of a word; said: what was tried and found, in one line; worst: the number that is bounded; limit: the greatest that
    is sound, None for what is only told."""

    name: str
    said: str
    worst: float
    limit: float | None

    @property
    def broken(self) -> bool:
        """Whether the bound is broken; NaN breaks any."""
        return self.limit is not None and not self.worst <= self.limit

    def as_dict(self) -> dict[str, Any]:
        """The fields, and whether the bound is broken; a number that is not finite is None, as JSON has none."""
        worst = self.worst if math.isfinite(self.worst) else None
        return asdict(self) | {"worst": worst, "broken": self.broken}

    def __str__(self) -> str:
        mark = "    " if self.limit is None else "BAD " if self.broken else "ok  "
        bound = "" if self.limit is None else f" (at most {self.limit:.2g})"
        return f"{mark}{self.name:<12}{self.said}{bound}"
