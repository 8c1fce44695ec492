//! The smallest firmware with the node in Rust, to measure its size: see tests/it/kit/size.rs. The linker
//! is told that the functions of the board are elsewhere.
#![no_std]
#![no_main]

use descan::node::{
    ExtendedClock, Node, NodeAction, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot,
};
use descan::wire::id::Service;

/// All service numbers, as in the configuration of the kit in C that is measured.
static CONFIG: NodeConfig = NodeConfig {
    identify: Some(Service::from_bits(0x018)),
    mode: Some(Service::from_bits(0x019)),
    reboot: Some(Service::from_bits(0x01A)),
    write_uid: Some(Service::from_bits(0x011)),
    write_address: Some(Service::from_bits(0x016)),
    write_bitrate: Some(Service::from_bits(0x015)),
    ..NodeConfig::DEFAULT
};

unsafe extern "Rust" {
    static device: NodeDevice<'static>;
    safe fn now() -> u32;
    safe fn entropy() -> u32;
    safe fn errors() -> u32;
    safe fn take(frame: &mut NodeFrame) -> bool;
    safe fn application(frame: &NodeFrame);
    safe fn set_up(bitrate: u32, is_silent: bool);
    safe fn event(action: u32);
    safe fn load(settings: &mut NodeSettings);
    safe fn store(settings: &NodeSettings) -> bool;
    safe fn transmit(slot: u32, frame: &NodeFrame) -> bool;
    safe fn transmitted(slot: u32) -> u32;
}

/// Measured: 240 bytes of RAM for three requesters; 5 % more.
const _: () = assert!(size_of::<Node>() <= 252);

#[panic_handler]
fn halt(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

#[unsafe(no_mangle)]
extern "C" fn _start() -> ! {
    let mut settings = NodeSettings::BLANK;
    load(&mut settings);
    // SAFETY: the board has it, and never changes it.
    let it = unsafe { &device };
    let mut node: Node = Node::new(&CONFIG, it, settings, entropy());
    let mut clock = ExtendedClock::default();
    let Some(mut frame) = NodeFrame::classic(0, &[]) else { loop {} };
    loop {
        let moment = clock.extend(now());
        for slot in Slot::ALL {
            match transmitted(slot as u32) {
                0 => {}
                result => node.handle_transmitted(moment, slot, result == 1),
            }
        }
        while take(&mut frame) {
            if node.handle_frame(moment, &frame) {
                application(&frame);
            }
        }
        let state = errors();
        node.handle_errors(state as u16, state >> 16 != 0);
        node.handle_timeout(moment);
        while let Some(action) = node.poll_action() {
            match action {
                NodeAction::SetUp { bitrate, is_silent } => set_up(bitrate, is_silent),
                NodeAction::Store(settings) => {
                    let is_stored = store(&settings);
                    node.handle_stored(is_stored);
                }
                NodeAction::ModeChanged(mode) => event(mode as u32),
                NodeAction::Identify => event(0x100),
                NodeAction::Reboot => event(0x200),
            }
        }
        for slot in Slot::ALL {
            if let Some(frame) = node.poll_transmit(slot)
                && !transmit(slot as u32, &frame)
            {
                node.handle_transmitted(moment, slot, false);
            }
        }
    }
}
