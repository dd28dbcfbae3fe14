# SPDX-License-Identifier: Apache-2.0
"""Report of a fleet as one HTML page."""
