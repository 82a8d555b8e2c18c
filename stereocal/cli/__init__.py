"""The command line: a thin face over :mod:`stereocal.workflow`.

========================  =========================================================================
``main``                  entry point: runs a command, turns errors into one sentence and an exit code
``app``                   the application, and what all commands share
``commands``              all commands, from the three modules that follow
``commands_calibration``  demo, board, detect, calibrate
``commands_depth``        rectify, disparity, sweep
``commands_tools``        crosscheck, convert, fetch, bench
``bench_table``           the table of bench for a terminal of any width
``summaries``             what a person reads when a command is done: what was found, and comes next
``terminal``              standard output and standard error; progress bars
========================  =========================================================================
"""
