#!/usr/bin/env bash
# Makes a keystore for DDS security: a key, a certificate and the permissions of stressbot.policy.xml for each enclave.
# Usage, on a native ROS 2 with sros2: make_keystore.sh FOLDER     (ROS_DOMAIN_ID as the nodes will have it)
# See docs/security.md. FOLDER/private signs everybody's permissions: keep it away from the machines that run nodes.
set -euo pipefail
umask 077 # whoever reads the keys may do what they allow
keystore=${1:?"usage: make_keystore.sh FOLDER"}
policy=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)/stressbot.policy.xml
[ -e "$keystore/public" ] || ros2 security create_keystore "$keystore"
sed -n 's/.*<enclave path="\([^"]*\)".*/\1/p' "$policy" | while read -r enclave; do
    [ -e "$keystore/enclaves$enclave/cert.pem" ] || ros2 security create_enclave "$keystore" "$enclave" </dev/null
    ros2 security create_permission "$keystore" "$enclave" "$policy" </dev/null
done
