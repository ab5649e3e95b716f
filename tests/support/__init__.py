"""What the test tables share: small scenes, short runs, and statistics that say whether two runs estimate one picture."""
