"""The steps of a measurement, each from open devices or recorded sessions to a value."""
