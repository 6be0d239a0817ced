"""Who may publish what, derived from the topics table: the access-control list of every process.

Each process enforces the whole list on what it receives; a peer is known by the common name of its
certificate. What no rule allows is refused.
"""

from __future__ import annotations

from typing import Any

from hil_gateway.bus.topics import TOPICS

ROUTER = "router"
"""Passes on what others publish: it enforces the list itself, so the processes behind it have to trust it."""
ROLES = (
    "gateway", "estimator", "learner", "planner", "operator", "recorder", "dashboard", "plant", "ros2", "receiver",
    "joystick", ROUTER,
)  # fmt: skip
"""Common names of the certificates; what a role publishes is in the topics table."""
KEYS = ("av24/**", "referee/**")


def access_control() -> dict[str, Any]:
    """Zenoh's `access_control` tree: everybody known may read, each topic has one publisher."""
    publishers = sorted({topic.publisher for topic in TOPICS})
    read = {
        "id": "read",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": ["declare_subscriber"],
        "key_exprs": list(KEYS),
    }
    send = {"id": "send", "permission": "allow", "flows": ["egress"], "messages": ["put"], "key_exprs": list(KEYS)}
    publish = [
        {
            "id": f"publish-{publisher}",
            "permission": "allow",
            "flows": ["ingress"],
            "messages": ["put"],
            "key_exprs": [topic.key for topic in TOPICS if topic.publisher == publisher],
        }
        for publisher in publishers
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [read, send, *publish],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in ROLES],
        "policies": [
            {"rules": ["read", "send"], "subjects": list(ROLES)},
            *({"rules": [f"publish-{name}"], "subjects": [name, ROUTER]} for name in publishers),
        ],
    }


def secure_session(role: str, folder: str) -> dict[str, Any]:
    """The `zenoh.extra` tree of a role: TLS with client certificates out of `folder`, and the list above."""
    if role not in ROLES:
        raise ValueError(f"{role} is no role: {', '.join(ROLES)}")
    key, certificate = f"{folder}/{role}.key", f"{folder}/{role}.pem"
    return {
        "transport": {
            "link": {
                "protocols": ["tls"],
                "tls": {
                    "root_ca_certificate": f"{folder}/ca.pem",
                    "enable_mtls": True,
                    "verify_name_on_connect": True,
                    "listen_private_key": key,
                    "listen_certificate": certificate,
                    "connect_private_key": key,
                    "connect_certificate": certificate,
                },
            }
        },
        "access_control": access_control(),
    }
