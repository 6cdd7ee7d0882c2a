"""What a whole-body policy promises, and the evaluation that holds it to that: ``station rehearse --suite``."""
