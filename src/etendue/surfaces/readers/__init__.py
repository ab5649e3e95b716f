"""Patches read from mesh files and from Mitsuba scenes."""
