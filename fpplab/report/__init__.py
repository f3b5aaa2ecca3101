"""Reports: figures as PNG, and HTML pages that hold them."""

from fpplab.report.measurements import write_report
from fpplab.report.page import PageBasis, is_report
from fpplab.report.scan_section import ScanSection
from fpplab.report.scans import write_scan_report

__all__ = ["PageBasis", "ScanSection", "is_report", "write_report", "write_scan_report"]
