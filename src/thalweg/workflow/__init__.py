"""What jobs share: provenance, code versions, the truth kept from processing."""
