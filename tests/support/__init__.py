"""What several kinds of tests share: each thing is written once, here."""
