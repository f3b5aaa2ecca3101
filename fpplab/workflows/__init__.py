"""What a command does, as a function: from a request to a result, with the files that it leaves.

Each module has a frozen request, a function `run_…` from a request and an observer to a result of
`fpplab.results`, and nothing of a terminal. Most import what measures and draws inside their functions, so
that wrong input is refused at once.
"""
