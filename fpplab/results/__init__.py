"""What workflows give: values that reports draw, commands print, and Python programs use."""
