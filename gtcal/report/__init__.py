"""The report: one HTML file that shows a calibration and what it rests on. Loads matplotlib; import it late."""

from gtcal.report.evidence import Evidence as Evidence
from gtcal.report.evidence import gather_evidence as gather_evidence
from gtcal.report.page import render as render
from gtcal.report.page import write_report as write_report
