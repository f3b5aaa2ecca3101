"""Reports: figures as PNG, and HTML pages that hold them."""
