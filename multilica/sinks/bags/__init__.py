# SPDX-License-Identifier: Apache-2.0
"""Writers of snapshots as other recorders write their logs."""
