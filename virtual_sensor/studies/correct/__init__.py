"""The error removed: points measured through hot air, corrected through known or estimated air."""
