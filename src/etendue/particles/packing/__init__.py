"""Codecs of particles: chunks of bytes, with and without loss."""
