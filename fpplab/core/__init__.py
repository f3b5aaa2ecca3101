"""Basis of all packages: conventions, geometry, configuration files, errors and files."""
