"""The command line: a thin face over :mod:`stereocal.workflow`.

=============  ===================================================================================
``main``       entry point: runs a command, turns errors into one sentence and an exit code
``commands``   the commands' names, options and help
``summaries``  what a person reads when a command is done: what was done, found, and comes next
``terminal``   standard output and standard error; progress bars
=============  ===================================================================================
"""
