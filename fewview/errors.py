"""Errors that a user can act on; each message names the thing at fault and the remedy."""

from __future__ import annotations


class FewviewError(Exception):
    """A problem in the input or the arguments: one clear line for the user, exit code 2."""


class ScanError(FewviewError):
    """A scan folder or one of its files cannot be used."""


class ConfigError(FewviewError):
    """A setting is unknown or has a value that cannot be used."""


class PriorsError(FewviewError):
    """What the user says to know of the scans is malformed or contradicts itself."""
