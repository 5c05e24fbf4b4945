"""The watch of a campaign: what truly happens, compared with what was promised."""
