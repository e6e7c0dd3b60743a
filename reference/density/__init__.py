"""Ways of density control beside the first one's: relocation, and evidence from several views."""
