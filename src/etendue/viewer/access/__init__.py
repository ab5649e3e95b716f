"""Who is answered, and under which address."""
