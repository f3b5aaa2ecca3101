"""What makes the documentation: pages are run, reference pages and pictures are generated."""
