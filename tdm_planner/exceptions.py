# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The package's errors: one family, each with the code that the `plan` service answers."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
import json
import linecache
from pathlib import Path
import traceback
from typing import ClassVar

_SPECS = [find_spec(name) for name in ('casadi', 'numpy', 'scipy', 'tdm_planner')]
_FOLDERS = [f'{Path(spec.origin).parent}/' for spec in _SPECS if spec and spec.origin]
_LIBRARIES = *_FOLDERS, '<frozen ', '<string>'
_STANDARD = f'{Path(traceback.__file__).parent}/'  # library; other packages may be below it


class TdmError(Exception):
    """Base of every error a user can cause or meet; the message is one clear sentence."""

    code: ClassVar[str] = 'ERROR'

    @property
    def reason(self) -> str:
        """Return the message."""
        return str(self)


class InvalidProblem(TdmError):
    """The request is malformed: the message names the parameter, the value and what is allowed."""

    code: ClassVar[str] = 'INVALID_PROBLEM'


class NotFinite(InvalidProblem):
    """A function that states the problem gives NaN or infinity somewhere along a motion."""


class NoState(TdmError):
    """The state to start from was never received, is incomplete or too old."""

    code: ClassVar[str] = 'NO_STATE'


class Busy(TdmError):
    """A request is already being solved."""

    code: ClassVar[str] = 'BUSY'


class Inactive(TdmError):
    """The planner is not active: a lifecycle manager has yet to activate it, or took it back."""

    code: ClassVar[str] = 'INACTIVE'


class Infeasible(TdmError):
    """No plan: the search ended without one that satisfies every constraint."""

    code: ClassVar[str] = 'INFEASIBLE'


class DeadlineExceeded(Infeasible):
    """No plan yet when the time allowed had passed; more time may give one."""

    code: ClassVar[str] = 'DEADLINE'


class VerificationFailed(Infeasible):
    """Candidates were found, but none survived the replay through the true dynamics."""

    code: ClassVar[str] = 'VERIFICATION_FAILED'


class PlannerFault(TdmError):
    """A fault of the planner's program, or of a problem of one's own; the planner serves on."""

    code: ClassVar[str] = 'INTERNAL'


class NoAnswer(TdmError):
    """No planner was found, or it did not answer in time; raised by `tdm_planner.client`."""

    code: ClassVar[str] = 'NO_ANSWER'


# Those that the `plan` service may answer; the pages list their codes in this order.
ERRORS: tuple[type[TdmError], ...] = (
    InvalidProblem,
    NoState,
    Infeasible,
    DeadlineExceeded,
    VerificationFailed,
    Busy,
    Inactive,
    PlannerFault,
)


def one_line(error: BaseException) -> str:
    """Return what an exception says, on one line."""
    return ' '.join(str(error).split())


def place_of(error: BaseException) -> tuple[str, str]:
    """
    Return where in a user's source an exception arises, in words, and the source of that line.

    Both are '' where that is in libraries or in this package.
    """
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        standard = frame.filename.startswith(_STANDARD) and '-packages/' not in frame.filename
        if not standard and not frame.filename.startswith(_LIBRARIES):
            source = linecache.getline(frame.filename, frame.lineno or 0).strip() or frame.name
            name = frame.filename.rsplit('/', 1)[-1]
            return f' in line {frame.lineno} of {name}, `{source}`', source
    return '', ''


@dataclass(frozen=True)
class Failure:
    """What an exception tells; `trace` is the traceback of a fault of the program, else empty."""

    code: str
    reason: str
    trace: str = ''

    @classmethod
    def of(cls, error: Exception) -> Failure:
        """Return the failure that an exception stands for: what is no TdmError is INTERNAL."""
        text = one_line(error)
        if isinstance(error, TdmError):
            return cls(error.code, text)
        trace = ''.join(traceback.format_exception(error))
        return cls(PlannerFault.code, f'{type(error).__name__}: {text}', trace)

    @property
    def sentence(self) -> str:
        """Return the reason, and INTERNAL before it where the program is at fault."""
        return f'{self.code}: {self.reason}' if self.trace else self.reason

    def __str__(self) -> str:
        """Return code and reason, and the traceback where there is one."""
        return '\n'.join(filter(None, [f'{self.code}: {self.reason}', self.trace]))

    def to_json(self) -> str:
        """Return the answer to the request, one line."""
        return json.dumps({'code': self.code, 'reason': self.reason})
