"""Profiles: one TOML file per logger says which of its columns are which canonical signals."""
