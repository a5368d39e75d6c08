"""Network captures: pcap and pcapng, gaps and cut files counted."""
