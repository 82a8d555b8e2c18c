"""All commands: importing this module enters them in the application.

Each command parses what was typed, calls one function of :mod:`stereocal.workflow`, and hands the result to
:mod:`~stereocal.cli.summaries`, or prints it as JSON. Workflows are imported inside the commands: ``stereocal --help``
must not wait for Numba.
"""

from stereocal.cli import commands_calibration, commands_depth, commands_tools
from stereocal.cli.app import UsageError, app

__all__ = ["UsageError", "app", "commands_calibration", "commands_depth", "commands_tools"]
