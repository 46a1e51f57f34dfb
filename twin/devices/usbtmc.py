"""A USBTMC-USB488 instrument on the bus: its transfers, and the requests to endpoint 0.

Source: USB-IF, USBTMC 1.0 section 4, USB488 section 4; USB 2.0 section 9.4. Assumed (to be confirmed on hardware): an
answer that is not ready yet when its transfer is aborted comes afterwards, as in IEEE 488.2's output queue.
"""

import struct

from goniotwin.protocols.usb_descriptors import CONFIGURATION, DEVICE, STRING
from goniotwin.protocols.usbtmc import HEADER_BYTES, PROTOCOL_USB488, ClassRequest, RequestStatus, capabilities
from goniotwin.twin.devices.usb_standard import (
    BULK_IN,
    BULK_OUT,
    ENDPOINTS,
    HALT_FEATURE,
    configuration_descriptor,
    device_descriptor,
    string_descriptor,
)
from goniotwin.twin.devices.usbtmc_transfers import Stall, Transfers

PROTOCOL = PROTOCOL_USB488
CLASS_TO_INTERFACE, CLASS_TO_ENDPOINT = 0xA1, 0xA2
LENGTHS = {
    ClassRequest.INITIATE_ABORT_BULK_OUT: 2,
    ClassRequest.CHECK_ABORT_BULK_OUT_STATUS: 8,
    ClassRequest.INITIATE_ABORT_BULK_IN: 2,
    ClassRequest.CHECK_ABORT_BULK_IN_STATUS: 8,
    ClassRequest.INITIATE_CLEAR: 1,
    ClassRequest.CHECK_CLEAR_STATUS: 2,
    ClassRequest.GET_CAPABILITIES: 24,
    ClassRequest.INDICATOR_PULSE: 1,
    ClassRequest.READ_STATUS_BYTE: 3,
    ClassRequest.REN_CONTROL: 1,
    ClassRequest.GO_TO_LOCAL: 1,
    ClassRequest.LOCAL_LOCKOUT: 1,
}


class UsbTmcDevice(Transfers):
    """One instrument on the bus. Times are those at which a transfer reaches it."""

    def control_in(self, request: int, value: int, t: float) -> bytes:
        """A class request and its answer. Raises Stall for one that the device does not know."""
        if request not in LENGTHS:
            raise Stall
        of_endpoint = ClassRequest(request).of_endpoint
        index = 0
        if of_endpoint:
            index = BULK_OUT if request <= ClassRequest.CHECK_ABORT_BULK_OUT_STATUS else BULK_IN
        return self.control(CLASS_TO_ENDPOINT if of_endpoint else CLASS_TO_INTERFACE, request, value, index, 0xFF, t)

    def control(self, kind: int, request: int, value: int, index: int, length: int, t: float) -> bytes:
        """Any request to endpoint 0: bmRequestType, bRequest, wValue, wIndex, wLength; its answer.

        Raises Stall for one that the device does not know, or that goes to a wrong place.
        """
        self.log.append((t, "control", struct.pack("<BBHHH", kind, request, value, index, length)))
        if kind & 0x60 == 0:
            return self._standard(kind, request, value, index)[:length]
        if request not in LENGTHS:
            raise Stall
        known = ClassRequest(request)
        if kind != (CLASS_TO_ENDPOINT if known.of_endpoint else CLASS_TO_INTERFACE):
            raise Stall
        if index != (
            0 if not known.of_endpoint else BULK_OUT if known <= ClassRequest.CHECK_ABORT_BULK_OUT_STATUS else BULK_IN
        ):
            raise Stall
        if length < LENGTHS[known]:
            self.complaints.append(f"{known.name}: room for {length} of {LENGTHS[known]} bytes")
        return self._class_request(known, value, t)[:length]

    def _class_request(self, request: ClassRequest, value: int, t: float) -> bytes:
        match request:
            case ClassRequest.GET_CAPABILITIES:
                return capabilities()
            case ClassRequest.INITIATE_CLEAR:
                return self._initiate_clear(t)
            case ClassRequest.CHECK_CLEAR_STATUS:
                if self._fifo is not None:
                    return bytes((RequestStatus.PENDING, 1))
                return bytes((RequestStatus.PENDING if t < self._clear_until else RequestStatus.SUCCESS, 0))
            case ClassRequest.INITIATE_ABORT_BULK_OUT:
                return self._abort_out(value)
            case ClassRequest.CHECK_ABORT_BULK_OUT_STATUS:
                return bytes((RequestStatus.SUCCESS, 0, 0, 0)) + self._received.to_bytes(4, "little")
            case ClassRequest.INITIATE_ABORT_BULK_IN:
                return self._abort_in(value, t)
            case ClassRequest.CHECK_ABORT_BULK_IN_STATUS:
                return self._check_abort_in()
            case ClassRequest.READ_STATUS_BYTE:
                return self._read_status(value, t)
            case ClassRequest.INDICATOR_PULSE:
                self.pulses += 1
            case ClassRequest.REN_CONTROL:
                self.remote = bool(value & 1)
                self.locked_out = self.locked_out and self.remote
            case ClassRequest.GO_TO_LOCAL:
                self.remote = self.locked_out = False
            case ClassRequest.LOCAL_LOCKOUT:
                self.locked_out = True
        return bytes((RequestStatus.SUCCESS,))

    def _initiate_clear(self, t: float) -> bytes:
        fifo = self._fifo if self.keeps_fifo else None
        self._clear()
        self._fifo = fifo
        self._notices.clear()
        self._reported = 0
        self._halted.add(BULK_OUT)  # until the host has seen the end of the clear, and confirms it
        self._clear_until = t + self.clear_s
        self.instrument.clear(t)
        return bytes((RequestStatus.SUCCESS,))

    def _abort_out(self, tag: int) -> bytes:
        if not self._transfer and not self._input:
            return bytes((RequestStatus.FAILED, self._last_out))
        current = self._transfer[1] if self._transfer else self._last_out
        if current != tag:
            return bytes((RequestStatus.TRANSFER_NOT_IN_PROGRESS, current))
        self._received = max(0, len(self._transfer) - HEADER_BYTES)
        self._transfer.clear()
        self._input.clear()
        self._halted.add(BULK_OUT)
        return bytes((RequestStatus.SUCCESS, tag))

    def _abort_in(self, tag: int, t: float) -> bytes:
        if self._fifo is not None:
            current = self._last_in
        elif self._request is not None:
            current = self._request.tag
        else:
            return bytes((RequestStatus.FAILED, self._last_in))
        if current != tag:
            return bytes((RequestStatus.TRANSFER_NOT_IN_PROGRESS, current))
        if self._fifo is not None or (self._answers and self._answers[0][0] <= t):
            self._answers.clear()
        self._request, self._last_in = None, tag
        self._sent = 0
        self._fifo, self._aborting = b"", True  # the short packet that ends what has been aborted
        return bytes((RequestStatus.SUCCESS, tag))

    def _check_abort_in(self) -> bytes:
        pending = self._aborting and self._fifo is not None and self.keeps_fifo
        if self._aborting and not pending:
            self._fifo, self._aborting = None, False  # taken out of the FIFO, which this device can
        status = RequestStatus.PENDING if pending else RequestStatus.SUCCESS
        return bytes((status, int(pending), 0, 0)) + self._sent.to_bytes(4, "little")

    def _standard(self, kind: int, request: int, value: int, index: int) -> bytes:
        addresses = {address for address, _ in ENDPOINTS}
        match kind, request:
            case 0x80, 6:
                return self._descriptor(value)
            case 0x80, 0:
                return bytes((1, 0))  # self-powered
            case 0x81, 0:
                return bytes(2)
            case 0x82, 0 if index in addresses or index & 0x7F == 0:
                return bytes((int(index in self._halted), 0))
            case 0x02, 1 if value == HALT_FEATURE and index in addresses:
                self.clear_halt(index)
                return b""
            case 0x02, 3 if value == HALT_FEATURE and index in addresses:
                self._halted.add(index)
                return b""
            case 0x80, 8:
                return bytes((1,))
            case 0x81, 10:
                return bytes((0,))
            case (0x00, 9) if value in (0, 1):
                return b""
            case (0x01, 11) if value == 0:
                return b""
        raise Stall

    def _descriptor(self, value: int) -> bytes:
        instrument = self.instrument
        match value >> 8:
            case kind if kind == DEVICE:
                return device_descriptor(instrument.vendor_id, instrument.product_id)
            case kind if kind == CONFIGURATION and value & 0xFF == 0:
                return configuration_descriptor()
            case kind if kind == STRING:
                texts = {1: instrument.manufacturer, 2: instrument.product, 3: self.serial_number}
                found = string_descriptor(value & 0xFF, texts)
                if found is not None:
                    return found
        raise Stall
