# SPDX-License-Identifier: Apache-2.0
"""Results and snapshots as MCAP files."""
