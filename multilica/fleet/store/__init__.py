# SPDX-License-Identifier: Apache-2.0
"""The fleet's tables and files: their schema, where they lie, and questions about them."""
