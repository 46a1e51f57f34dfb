"""The command line: a file for each group of commands, and `main`, the entry point.

These files have what a command line is: options, help, exit statuses, and which options belong together. What a command does is
in `work` and in the rooms below, which a command imports within its function: they load numpy, pydantic and numba, for up to
1.4 s, which help, completion and a refused option do without. That is the reason for every import within a function here.
"""
