"""What a command does, as a function: from a request to a result, with the files that it leaves.

Each module has a frozen request, a function `run_…` from a request and an observer to a result of
`fpplab.results`, and nothing of a terminal. Requests are light to import: what measures and draws is imported
when wrong input has been refused.
"""
