#!/bin/bash
# deploy/zenoh/make-certificates.sh FOLDER [HOST...]: a certificate authority, one certificate per process (common
# name = its role), and per role a Zenoh file for `zenoh.extra`. HOST are the names and addresses the computers
# are reached by (default: localhost 127.0.0.1). Copy to each computer ca.pem and the three files of its roles only;
# ca.key stays off the vehicle. Valid 398 days; run again with the same FOLDER to renew from the same authority.
set -euo pipefail
case ${1-} in
    "" | -*) sed -n '2,5s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac
folder=$1; shift
hosts=("$@"); [ ${#hosts[@]} -gt 0 ] || hosts=(localhost 127.0.0.1)
roles=(gateway estimator learner planner operator recorder dashboard plant ros2 receiver joystick router)
days=398
here=$(cd "$(dirname "$0")" && pwd)

command -v openssl >/dev/null || { echo "make-certificates: openssl is missing: apt-get install openssl" >&2; exit 2; }
umask 077
mkdir -p "$folder" || exit 2
folder=$(cd "$folder" && pwd)

names=""
for host in "${hosts[@]}"; do
    kind=DNS
    [[ $host =~ ^[0-9.]+$ || $host == *:* ]] && kind=IP
    names+="${names:+,}$kind:$host"
done

key() { openssl genpkey -quiet -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1" 2>/dev/null ||
        openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1" 2>/dev/null; }

if [ ! -f "$folder/ca.key" ]; then
    key "$folder/ca.key"
    openssl req -x509 -new -key "$folder/ca.key" -days 3650 -subj "/CN=hil-gateway authority" -out "$folder/ca.pem" \
        -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign,cRLSign"
fi

for role in "${roles[@]}"; do
    key "$folder/$role.key"
    openssl req -new -key "$folder/$role.key" -subj "/CN=$role" -out "$folder/$role.csr"
    openssl x509 -req -in "$folder/$role.csr" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" -CAcreateserial \
        -days "$days" -out "$folder/$role.pem" 2>/dev/null \
        -extfile <(printf 'subjectAltName=%s\nextendedKeyUsage=serverAuth,clientAuth\nbasicConstraints=CA:FALSE\n' "$names")
    rm "$folder/$role.csr"
    sed -e "s#@FOLDER@#$folder#g" -e "s#@ROLE@#$role#g" "$here/../../hil_gateway/data/secure.json5" >"$folder/$role.json5"
done
chmod 644 "$folder"/*.pem "$folder"/*.json5
echo "certificates for ${roles[*]} in $folder, for ${hosts[*]}"
