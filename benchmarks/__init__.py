"""What is measured rather than tested: see the README for what each prints."""
