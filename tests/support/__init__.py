"""What the test tables share: small scenes, short runs, and statistics that compare two runs."""
