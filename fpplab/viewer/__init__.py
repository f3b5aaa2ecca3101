"""The viewer: what every command shows of its work, in a window or a page on this computer.

A command makes a `fpplab.viewer.viewer.Viewer` of one view (`measurement`, `matching`, `search`, …) and says
what there is to show. A process of its own draws that (`process`), and another runs rerun and serves its page
(`host`). `recorded` shows what was recorded before.
"""
