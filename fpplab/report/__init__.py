"""What people look at afterwards: pictures, and the page that holds them."""

from fpplab.report.page import ScanSection, write_report

__all__ = ["ScanSection", "write_report"]
