"""The experiments of a thesis on adaptive path tracing (Leeson, Trinity College Dublin, 2001), made again."""
