"""Reports, figures and exports of identified flights."""

from groundstation.reporting.report import report_html, write_report

__all__ = ["report_html", "write_report"]
