# SPDX-License-Identifier: Apache-2.0
"""`report.html`: a calibration on one page."""
