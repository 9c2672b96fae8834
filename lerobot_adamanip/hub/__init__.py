"""What goes to the Hugging Face Hub: cards, and publishing."""
