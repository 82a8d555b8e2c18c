"""Entry point: runs a command, turns errors into one sentence and an exit code.

========  =====================================================================================
0         done
1         the job failed; one line on standard error says what is wrong and what to do
2         wrong usage: an unknown command or option, a missing or misspelt value
130, 143  interrupted (Ctrl-C) or terminated; what stood in the output folder is untouched
========  =====================================================================================

``--debug`` shows the traceback instead of the line.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Sequence

from cyclopts import CycloptsError, UnusedCliTokensError
from rich.traceback import Traceback

from stereocal.base.errors import StereocalError
from stereocal.cli.commands import UsageError, app
from stereocal.cli.terminal import complain, errors

DONE, FAILED, WRONG_USAGE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        What was typed after ``stereocal``; by default this process's own arguments.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    previous = _exit_on_termination()
    try:
        with warnings.catch_warnings():
            if not debug:  # standard error belongs to the one line that says what failed
                warnings.simplefilter("ignore")
            return int(app(words, exit_on_error=False, print_error=False, result_action="return_value") or DONE)
    except (CycloptsError, UsageError) as error:
        complain(_usage_sentence(error, words))
        return WRONG_USAGE
    except KeyboardInterrupt:
        complain("interrupted; nothing was written")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the pipe has left, as `head` does: nothing is wrong
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        if debug:
            errors().print(Traceback(show_locals=False))
        complain(_sentence(error))
        return FAILED
    finally:
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)


def _sentence(error: Exception) -> str:
    if isinstance(error, StereocalError):
        return str(error)
    if isinstance(error, MemoryError):
        return "out of memory; use smaller images or fewer disparities"
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename else ""
        return f"{name}{error.strerror or error}; free some space or check the permissions"
    return f"internal error, {type(error).__name__}: {error}; run again with --debug and report what it shows"


def _usage_sentence(error: Exception, words: Sequence[str]) -> str:
    """Return what was wrong with the words in one line, with the way to the help."""
    message = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, UnusedCliTokensError):
        message = (
            f"too many arguments ({' '.join(error.unused_tokens or ())}); put a pattern such as 'left*.jpg' in quotes"
        )
    command = [words[0]] if words and words[0] in app else []
    return f"{message}; see `{' '.join(['stereocal', *command, '--help'])}`"


def _exit_on_termination() -> signal.Handlers | None:
    """Let SIGTERM unwind the stack, so that staging folders are removed; None where signals cannot be set."""
    try:
        previous = signal.getsignal(signal.SIGTERM)
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    except ValueError:  # not in the main thread: whoever runs us owns the signals
        return None
    return previous  # type: ignore[return-value]
