# SPDX-License-Identifier: Apache-2.0
"""What tasks use, imported once for all worker processes."""
