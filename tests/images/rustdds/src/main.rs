//! `rustdds-node talker|listener NAME`: std_msgs/String on /chatter, by RustDDS.
//!
//! It speaks on the one interface whose address is in DDS_ADDRESS, or on all that there are.
use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{Context, MessageTypeName, Name, Node, NodeName, NodeOptions};
use rustdds::DomainParticipantBuilder;
use std::time::Duration;

fn main() {
    let mut words = std::env::args().skip(1);
    let role = words.next().expect("talker or listener");
    let name = words.next().unwrap_or_else(|| format!("rustdds_{role}"));
    let mut node = node(&name);
    let qos = match role.as_str() {
        "talker" => QosProfile::publisher_default(),
        _ => QosProfile::subscription_default(),
    }
    .reliability_reliable(WhenFull::DEFAULT)
    .durability(Durability::Volatile)
    .history(History::KeepLast { depth: 10 });
    let chatter = node
        .create_topic(
            &Name::new("/", "chatter").expect("a name"),
            MessageTypeName::new("std_msgs", "String"),
            &qos,
        )
        .expect("a topic");
    match role.as_str() {
        "talker" => {
            let publisher = node
                .create_publisher::<String>(&chatter, None)
                .expect("a publisher");
            for count in 0.. {
                publisher
                    .publish(format!("hello world from {name}: none {count}"))
                    .expect("to publish");
                std::thread::sleep(Duration::from_millis(200));
            }
        }
        _ => {
            let subscription = node
                .create_subscription::<String>(&chatter, None)
                .expect("a subscription");
            loop {
                while let Ok(Some((message, _))) = subscription.take() {
                    println!("I heard {message}");
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
}

/// Return a ROS 2 node in the domain of ROS_DOMAIN_ID.
fn node(name: &str) -> Node {
    let domain = std::env::var("ROS_DOMAIN_ID").map_or(0, |d| d.parse().expect("a number"));
    let mut builder = DomainParticipantBuilder::new(domain);
    if let Ok(address) = std::env::var("DDS_ADDRESS") {
        builder =
            builder.with_only_networks([address.parse::<std::net::IpAddr>().expect("an address")]);
    }
    let participant = builder.build().expect("a participant");
    Context::from_domain_participant(participant)
        .expect("a context")
        .new_node(
            NodeName::new("/", name).expect("a name"),
            NodeOptions::new(),
        )
        .expect("a node")
}
