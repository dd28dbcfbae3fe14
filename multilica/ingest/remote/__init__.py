# SPDX-License-Identifier: Apache-2.0
"""Files on servers, read by ranges or copied."""
