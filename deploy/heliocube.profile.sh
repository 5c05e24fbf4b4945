# So that 'heliocube status', and above all 'heliocube stop', need no options. Holds for members of the group heliocube.
for role in tracker cube; do
  if [ -z "${HELIOCUBE_CONFIG:-}" ] && [ -r "/etc/heliocube/$role.toml" ]; then
    export HELIOCUBE_CONFIG="/etc/heliocube/$role.toml"
  fi
done
unset role
