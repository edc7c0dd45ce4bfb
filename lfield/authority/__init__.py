"""Authentication and authorisation: identities, the certificate authority of a team, keys, validity."""
