"""`hil demo`: the whole loop as separate processes, watched and judged from outside.

`options` turns flags into a configuration, `monitor` listens, `operator` arms and gives up, `referee` judges from
the plant's truth, `view` draws, `run` holds it together, `summary` reports.
"""
