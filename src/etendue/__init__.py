"""étendue: global illumination for Mitsuba 3 scenes."""
